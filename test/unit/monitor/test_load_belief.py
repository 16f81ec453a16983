"""When the model carries what the arm does: in every order in which executor and scene can be heard."""

from __future__ import annotations

import itertools

import pytest

from construction_twin.monitor.load_belief import LoadBelief


def believing(scene="before", load="nothing") -> LoadBelief:
    belief = LoadBelief()
    belief.on_scene(scene, load)
    belief.on_model(load)
    return belief


def test_before_the_first_scene_and_its_model_nothing_is_known():
    belief = LoadBelief()
    assert not belief.counts
    belief.on_scene("before", "nothing")
    assert not belief.counts
    belief.on_model("nothing")
    assert belief.counts


SWITCH = {
    "waits": lambda belief: belief.on_execution(True, True, "after"),
    "goes on": lambda belief: belief.on_execution(True, False, ""),
    "scene": lambda belief: belief.on_scene("after", "tile"),
    "model": lambda belief: belief.on_model("tile"),
}


#: The executor goes on after it has waited, and a model is made after its scene was heard.
ORDERS = [
    order
    for order in itertools.permutations(SWITCH)
    if order.index("waits") < order.index("goes on") and order.index("scene") < order.index("model")
]


@pytest.mark.parametrize("order", ORDERS)
def test_in_any_order_it_counts_only_when_all_is_known(order):
    belief = believing()
    belief.on_execution(True, True, "")
    for step in order:
        assert not belief.counts, step
        SWITCH[step](belief)
    assert belief.counts


def test_a_boundary_that_changes_nothing_ends_with_itself():
    belief = believing()
    belief.on_execution(True, True, "")
    assert not belief.counts
    belief.on_execution(True, False, "")
    assert belief.counts


def test_a_plan_that_has_ended_waits_for_no_scene():
    belief = believing()
    belief.on_execution(True, True, "after")
    belief.on_execution(False, True, "after")
    assert belief.counts


def test_another_scene_is_not_the_one_that_the_plan_waits_for():
    belief = believing()
    belief.on_execution(True, True, "after")
    belief.on_scene("other", "nothing")
    belief.on_execution(True, False, "")
    assert belief.is_modelled and not belief.counts
