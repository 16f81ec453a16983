"""The order of tasks: which jobs there are, what each waits for, and what makes no sense."""

import itertools
from dataclasses import replace

import pytest
from building_models import box, building, element
from hypothesis import given, settings
from hypothesis import strategies as st

from construction_twin.extensions.work.building import ScheduleError, Sequence, Task
from construction_twin.extensions.work.schedule import Schedule

KINDS = ("FINISH_START", "START_START", "FINISH_FINISH", "START_FINISH")


def model(tasks, sequences=(), elements=None):
    """A model whose elements are what its tasks make."""
    if elements is None:
        elements = dict.fromkeys(product for task in tasks for product in task.products)
    cube = box((0, 0, 0), (1, 1, 1))
    return building(*(element(one, cube) for one in elements), tasks=tasks, sequences=sequences)


def leaves(*names, parent=""):
    return [Task(name, name.upper(), parent=parent, products=(f"e{name}",)) for name in names]


def allowed(schedule, started, finished, now, robot=""):
    """The jobs that may start now, in order."""
    mine = [
        job
        for job in schedule.jobs
        if job.id not in {**started, **finished} and robot in ("", *(job.robots or (robot,)))
    ]
    return tuple(job for job in mine if not schedule.waits_for(job.id, started, finished, now))


def ids(jobs):
    return [job.id for job in jobs]


def test_a_lag_is_waited_for_and_its_rest_is_told():
    schedule = Schedule.of(model(leaves("a", "b"), [Sequence("a", "b", lag=60.0)]))
    assert allowed(schedule, {}, {"a": 100.0}, 159.0) == ()
    assert schedule.waits_for("b", {}, {"a": 100.0}, 130.0).startswith("30 s from now, its lag after")
    assert ids(allowed(schedule, {}, {"a": 100.0}, 160.0)) == ["b"]


def test_a_lead_is_not_used_and_a_note_says_so():
    schedule = Schedule.of(model(leaves("a", "b"), [Sequence("a", "b", lag=-60.0)]))
    assert allowed(schedule, {"a": 0.0}, {}, 100.0) == ()
    assert "lead from a to b" in schedule.notes[0]


def test_a_milestone_passes_order_and_lag_on():
    tasks = [*leaves("a", "b"), Task("m", "M", milestone=True)]
    schedule = Schedule.of(model(tasks, [Sequence("a", "m", lag=5.0), Sequence("m", "b", lag=7.0)]))
    (wait,) = schedule.job("b").after
    assert (wait.job, wait.finished, wait.lag) == ("a", True, 12.0)
    assert schedule.notes == ()


def test_a_task_without_element_is_noted_and_kept_as_order():
    schedule = Schedule.of(model([*leaves("a", "b"), Task("x", "Cure")], [Sequence("a", "x"), Sequence("x", "b")]))
    assert [wait.job for wait in schedule.job("b").after] == ["a"]
    assert schedule.notes == ("1 task without element: x; kept for the order, no time is waited for.",)


def test_jobs_that_share_a_name_have_their_elements_behind_it():
    cube = box((0, 0, 0), (1, 1, 1))
    elements = [
        replace(element(one, cube), name=name) for one, name in zip("pqrst", ("low", "high", "", "Place s", "t"))
    ]
    tasks = [
        Task("a", "Panel up", products=("p", "q", "r")),
        Task("b", "Panel up", products=("t",)),
        Task("c", "Place s", products=("s",)),
    ]
    schedule = Schedule.of(building(*elements, tasks=tasks))
    assert [job.name for job in schedule.jobs] == [
        "Panel up: low",
        "Panel up: high",
        "Panel up",
        "Panel up: t",
        "Place s",
    ]


def test_a_task_of_several_elements_is_one_job_each_in_the_files_order():
    tasks = [Task("t", "T", products=("e2", "e1", "e3")), *leaves("u")]
    schedule = Schedule.of(model(tasks, [Sequence("t", "u")]))
    assert [(job.id, job.element) for job in schedule.jobs[:3]] == [("t/1", "e2"), ("t/2", "e1"), ("t/3", "e3")]
    assert ids(allowed(schedule, {}, {"t/1": 0.0}, 0.0)) == ["t/2"]
    assert [wait.job for wait in schedule.job("u").after] == ["t/3"]


def test_an_element_made_twice_is_refused_with_its_tasks():
    with pytest.raises(ScheduleError, match="ex .*made twice.*a and b"):
        Schedule.of(model([Task("a", "A", products=("ex",)), Task("b", "B", products=("ex",))]))


def test_an_unknown_product_is_noted_and_an_unmade_element_too():
    schedule = Schedule.of(model([Task("a", "A", products=("gone",)), *leaves("b")], elements=["eb", "ez"]))
    assert ids(schedule.jobs) == ["b"] and any("No task makes 1 of the elements" in note for note in schedule.notes)
    assert any("gone" in note for note in schedule.notes) and any("ez" in note for note in schedule.notes)


def test_what_a_nesting_task_makes_is_left_to_those_it_nests():
    tasks = [Task("A", "A", products=("ea",)), *leaves("a", parent="A")]
    schedule = Schedule.of(model(tasks))
    assert ids(schedule.jobs) == ["a"] and "ea" in schedule.notes[0]


def test_robots_come_from_the_task_or_from_what_it_nests_in():
    tasks = [Task("A", "A", robots=("left",)), *leaves("a", parent="A")]
    tasks += [Task("b", "B", parent="A", products=("eb",), robots=("right",)), *leaves("c")]
    schedule = Schedule.of(model(tasks))
    assert ids(allowed(schedule, {}, {}, 0.0, robot="left")) == ["a", "c"]
    assert ids(allowed(schedule, {}, {}, 0.0, robot="right")) == ["b", "c"]


def test_jobs_stand_in_the_order_of_their_dates_if_all_have_one():
    dated = [Task(n, n, products=(f"e{n}",), start=f"2026-01-0{d}T08:00:00") for n, d in (("a", 3), ("b", 1), ("c", 2))]
    assert ids(Schedule.of(model(dated)).jobs) == ["b", "c", "a"]
    assert Schedule.of(model(dated)).notes == ()
    zoned = Task("z", "z", products=("ez",), start="2026-01-01T08:00:00+01:00")
    for other, why in ((*leaves("d"), "1 of 4 jobs have none"), (zoned, "some have a time zone")):
        schedule = Schedule.of(model([*dated, other]))
        assert ids(schedule.jobs) == ["a", "b", "c", other.id]
        assert schedule.notes[-1].startswith(f"Dates are not used for the order, because {why}")


def test_an_order_that_nobody_says_is_told_unless_it_is_proposed():
    said = "The file says no order of its tasks"
    assert any(said in note for note in Schedule.of(model(leaves("a", "b"))).notes)
    assert not any(said in note for note in Schedule.of(model(leaves("a", "b")), proposed=True).notes)
    for tasks, sequences in ((leaves("a"), []), (leaves("a", "b"), [Sequence("a", "b")])):
        assert not any(said in note for note in Schedule.of(model(tasks, sequences)).notes)


@pytest.mark.parametrize(
    ("tasks", "sequences", "message"),
    [
        ([], [], "no tasks"),
        (leaves("a"), [Sequence("a", "a")], "wait for itself"),
        ([Task("a", "", parent="b"), Task("b", "", parent="a")], [], "nest in each other in a circle: a, b"),
        ([Task("P", ""), *leaves("a", parent="P")], [Sequence("P", "a")], "wait for itself"),
        (leaves("a", "b"), [Sequence("a", "b"), Sequence("b", "a", "START_START")], "circle: (a.*b|b.*a)"),
    ],
)
def test_what_makes_no_sense_is_one_sentence_with_the_ids(tasks, sequences, message):
    with pytest.raises(ScheduleError, match=message) as caught:
        Schedule.of(model(tasks, sequences))
    assert "\n" not in str(caught.value)


# -- random graphs -----------------------------------------------------------------------------------------------------


@st.composite
def graphs(draw):
    """Tasks in up to two levels of nesting, some without product, and sequences between any two."""
    count = draw(st.integers(2, 9))
    groups = draw(st.integers(0, 2))
    tasks = [Task(f"g{i}", f"g{i}") for i in range(groups)]
    for i in range(count):
        parent = draw(st.sampled_from(["", *(f"g{k}" for k in range(groups))]))
        products = draw(st.sampled_from([(f"e{i}",), (f"e{i}",), (), (f"e{i}", f"f{i}")]))
        tasks.append(Task(f"t{i}", f"t{i}", parent=parent, products=products))
    names = [task.id for task in tasks]
    pairs = st.tuples(st.sampled_from(names), st.sampled_from(names))
    sequences = [
        Sequence(a, b, draw(st.sampled_from(KINDS)), draw(st.sampled_from([0.0, 0.0, 3.0, 10.0])))
        for a, b in draw(st.lists(pairs, max_size=10))
        if a != b and {task.id: task.parent for task in tasks}[a] != b and {t.id: t.parent for t in tasks}[b] != a
    ]
    return tasks, sequences


def below(tasks, name):
    """The tasks without subtasks below one, by brute force."""
    nested = [task.id for task in tasks if task.parent == name]
    return [leaf for child in nested for leaf in below(tasks, child)] if nested else [name]


def has_circle(tasks, sequences):
    """Whether leaves wait for themselves, by transitive closure; groups stand between leaves even if they are empty."""
    nodes = [task.id for task in tasks]
    edges = {(a, b) for s in sequences for a in below(tasks, s.before) for b in below(tasks, s.after)}
    reach = {(a, b): (a, b) in edges for a in nodes for b in nodes}
    for k, a, b in itertools.product(nodes, nodes, nodes):
        reach[a, b] = reach[a, b] or (reach[a, k] and reach[k, b])
    return any(reach[a, a] for a in nodes)


@settings(max_examples=120, deadline=None)
@given(graphs())
def test_a_schedule_is_refused_exactly_if_tasks_wait_for_each_other_in_a_circle(graph):
    tasks, sequences = graph
    try:
        Schedule.of(model(tasks, sequences))
        refused = False
    except ScheduleError as error:
        assert "circle" in str(error)
        refused = True
    assert refused == has_circle(tasks, sequences)


@settings(max_examples=120, deadline=None)
@given(graphs(), st.randoms(use_true_random=False))
def test_every_way_through_what_is_allowed_keeps_all_sequences_and_reaches_the_end(graph, random):
    tasks, sequences = graph
    if has_circle(tasks, sequences):
        return
    schedule = Schedule.of(model(tasks, sequences))
    started, finished, now = {}, {}, 0.0
    running = []
    while len(finished) < len(schedule.jobs):
        free = allowed(schedule, started, finished, now)
        if running and (not free or random.random() < 0.5):
            finished[running.pop(random.randrange(len(running)))] = now
        elif free:
            job = random.choice(free)
            started[job.id] = now
            running.append(job.id)
        else:
            assert now < 1e5, "nothing may start and nothing runs, yet jobs are left"
            now += 10.0
        now += random.random()
    by_task = {}
    for job in schedule.jobs:
        by_task.setdefault(job.task, []).append(job.id)
    for sequence in sequences:
        for a, b in itertools.product(below(tasks, sequence.before), below(tasks, sequence.after)):
            for first, second in itertools.product(by_task.get(a, []), by_task.get(b, [])):
                event = (started if sequence.kind.startswith("START") else finished)[first]
                assert event + sequence.lag <= started[second] + 1e-9
    order = {job.id: number for number, job in enumerate(schedule.jobs)}
    assert all(order[wait.job] < order[job.id] for job in schedule.jobs for wait in job.after)
