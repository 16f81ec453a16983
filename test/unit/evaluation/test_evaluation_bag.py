"""Reading a rosbag, and the command line on it."""

from __future__ import annotations

import contextlib
import json

import genpy
import numpy as np
import pytest
import rosbag
from construction_twin.msg import Execution, Feedback, Link, Plan, Sync
from diagnostic_msgs.msg import KeyValue
from evaluation_samples import BASE, JOINTS, link, run
from mcap.reader import make_reader
from mcap_ros1.decoder import DecoderFactory
from plan_samples import make_plan
from rosbags.typesys.store import Typestore
from scene_samples import kr120
from sensor_msgs.msg import JointState
from std_msgs.msg import Header, String
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from construction_twin.core.errors import ConstructionTwinError
from construction_twin.core.share import share_file
from construction_twin.evaluation.alignment import evaluate
from construction_twin.evaluation.bag import read_recording
from construction_twin.evaluation.tables import summarise
from construction_twin.planning.timing import time_path
from construction_twin.ros.commands.evaluate import main, read_plans
from construction_twin.ros.messages.convert import plan_to_msg

STATUS = {"state": "running", "counters": {}, "config": {"servo": "realistic"}}


def at(stamp) -> genpy.Time:
    return genpy.Time(0, int(stamp))


def write_joints(bag, topic, stream, names=JOINTS):
    columns = [JOINTS.index(name) for name in names]
    for stamp, position, received in zip(stream.stamps, stream.positions, stream.received):
        message = JointState(header=Header(stamp=at(stamp)), name=list(names), position=position[columns].tolist())
        bag.write(topic, message, at(received))


def write_extras(bag, recording, namespace):
    feedback, plan = recording.feedback, recording.plans[0]
    for row in zip(feedback.stamps, feedback.positions, feedback.received, feedback.seq, feedback.command_stamps):
        stamp, position, received, seq, command = row
        message = Feedback(Header(stamp=at(stamp)), list(JOINTS), position.tolist(), int(seq), at(command))
        bag.write(f"{namespace}/physical/feedback", message, at(received))
    write_joints(bag, f"{namespace}/command/joint_states", recording.command)
    trajectory = JointTrajectory(points=[JointTrajectoryPoint() for _ in range(200)])
    bag.write(f"{namespace}/plan", Plan(id=plan.plan_id, trajectory=trajectory), at(BASE + 1))
    execution = Execution(
        plan_id=plan.plan_id, plan_start=at(plan.start), duration=plan.duration, state=Execution.PLAYING
    )
    bag.write(f"{namespace}/execution", execution, at(plan.start))
    execution.state, execution.outcome = Execution.IDLE, "finished"
    bag.write(f"{namespace}/execution", execution, at(plan.end))
    for report in recording.links:
        message = Link(session=report.session, commands_sent=report.commands_sent)
        message.gateway_counters = [KeyValue(key, value) for key, value in report.counters.items()]
        message.reply_us_bins, message.reply_us_counts = report.reply_bins, report.reply_counts
        bag.write(f"{namespace}/link", message, at(report.received))
    bag.write(f"{namespace}/mock_rsi/status", String(json.dumps(STATUS)), at(BASE + 2))


def write_robot(bag, recording, namespace="/kr120", physical_names=JOINTS):
    write_joints(bag, f"{namespace}/twin/joint_states", recording.twin)
    write_joints(bag, f"{namespace}/physical/joint_states", recording.physical, physical_names)


@pytest.fixture(scope="module")
def recording():
    return run(duration=3.0, decimals=3, links=[link(0.5, 1), link(5.5, 2, lost=4, counts=(9, 8, 7, 6))])


@pytest.fixture(scope="module")
def full_bag(recording, tmp_path_factory):
    path = tmp_path_factory.mktemp("bag") / "full.bag"
    with rosbag.Bag(str(path), "w") as bag:
        write_robot(bag, recording)
        write_extras(bag, recording, "/kr120")
    return path


def test_everything_written_is_read_back_unchanged(recording, full_bag):
    read = read_recording(full_bag)
    assert (read.robot, read.joint_names) == ("/kr120", JOINTS)
    for name in ("twin", "physical", "command", "feedback"):
        for key, value in vars(getattr(recording, name)).items():
            np.testing.assert_array_equal(getattr(getattr(read, name), key), value)
    assert read.plans == recording.plans and read.waypoints == {"p1": 200}
    assert read.links == recording.links and read.mock == STATUS


def test_bag_gives_the_same_figures_as_the_run_itself(recording, full_bag):
    expected = summarise(evaluate(recording))
    expected |= {"servo": "realistic", "mock": {"servo": "realistic"}}
    assert summarise(evaluate(read_recording(full_bag))) == expected
    assert expected["lag_s"] == pytest.approx(0.012, abs=1e-9)


def test_the_whole_bag_as_mcap_is_read_by_another_reader_also_what_foxglove_s_layout_shows(full_bag, tmp_path, capsys):
    report = tmp_path / "report"
    assert main([str(full_bag), "--output", str(report), "--mcap"]) == 0
    file = report / "recording.mcap"
    assert str(file) in capsys.readouterr().out
    with rosbag.Bag(str(full_bag)) as bag:
        recorded = [(topic, message, stamp.to_nsec()) for topic, message, stamp in bag.read_messages()]
    with file.open("rb") as opened:
        reader = make_reader(opened, decoder_factories=[DecoderFactory()])
        read = [(channel.topic, own, record.log_time) for _, channel, record, own in reader.iter_decoded_messages()]
    assert len(read) == len(recorded) > 1000
    for (topic, message, stamp), (own_topic, own, own_stamp) in zip(recorded, read):
        assert (topic, stamp) == (own_topic, own_stamp)
        if hasattr(message, "position"):
            assert (
                list(message.position) == list(own.position)
                and message.header.stamp.to_nsec() == own.header.stamp.to_nsec()
            )
    layout = json.loads((share_file("config") / "foxglove_layout.json").read_text())
    shown = [path["value"] for panel in layout["configById"].values() for path in panel.get("paths", [])]
    # a topic, and a field of its message
    kinds = {"sync": Sync, "execution": Execution, "link": Link, "joint_states": JointState}
    for path in shown:
        topic, _, field = path.removesuffix("[:]").rpartition(".")
        assert field in kinds[topic.rpartition("/")[2]].__slots__
    panels = [word for word in json.dumps(layout["layout"]).split('"') if "!" in word]
    assert sorted(panels) == sorted(layout["configById"])


def test_bag_of_the_two_joint_topics_is_enough_for_instant(recording, tmp_path):
    with rosbag.Bag(str(tmp_path / "user.bag"), "w") as bag:
        write_robot(bag, recording, "/cell/kr120")
    read = read_recording(tmp_path / "user.bag")
    tables = summarise(evaluate(read))["tables"]
    assert read.robot == "/cell/kr120"
    assert tables["by_command"] is None and tables["lag_removed"] is None and set(tables["instant"]) == set(JOINTS)


def test_physical_joints_in_another_order_and_fewer_are_matched_by_name(recording, tmp_path):
    with rosbag.Bag(str(tmp_path / "subset.bag"), "w") as bag:
        write_robot(bag, recording, physical_names=("joint_a4", "joint_a2"))
    read = read_recording(tmp_path / "subset.bag")
    assert read.joint_names == ("joint_a2", "joint_a4")
    np.testing.assert_array_equal(read.physical.positions, recording.physical.positions[:, [1, 3]])


def test_two_robots_need_a_choice(recording, tmp_path):
    path = tmp_path / "two.bag"
    with rosbag.Bag(str(path), "w") as bag:
        write_robot(bag, recording, "/left")
        write_robot(bag, recording, "/right")
    with pytest.raises(ConstructionTwinError, match="the bag holds the robots /left, /right; name one of them"):
        read_recording(path)
    assert read_recording(path, "right/").robot == "/right"
    with pytest.raises(ConstructionTwinError, match="the bag holds no robot /middle; it holds /left, /right"):
        read_recording(path, "/middle")


def write_bag(path, topic=None, message=None):
    with rosbag.Bag(str(path), "w") as bag:
        if topic:
            bag.write(topic, message, at(BASE))


def test_bags_that_cannot_be_used_say_why(tmp_path):
    path = tmp_path / "x.bag"
    with pytest.raises(ConstructionTwinError, match="is not there; check the name"):
        read_recording(path)
    path.write_text("not a bag")
    with pytest.raises(ConstructionTwinError, match="cannot be read as a rosbag:"):
        read_recording(path)
    write_bag(path)
    with pytest.raises(ConstructionTwinError, match=r"the bag holds no topic \.\.\./twin/joint_states"):
        read_recording(path)
    write_bag(path, "/a/twin/joint_states", JointState(name=["j"], position=[0.0]))
    with pytest.raises(ConstructionTwinError, match="the bag holds no messages on /a/physical/joint_states"):
        read_recording(path)
    write_bag(path, "/a/twin/joint_states", String("x"))
    with pytest.raises(ConstructionTwinError, match="is a std_msgs/String; expected a sensor_msgs/JointState"):
        read_recording(path)


def test_bag_that_was_not_closed_names_the_remedy(full_bag, tmp_path):
    cut = tmp_path / "cut.bag.active"
    bag = rosbag.Bag(str(cut), "w")
    bag.write("/a/twin/joint_states", JointState(), at(BASE))
    bag.flush()
    with pytest.raises(ConstructionTwinError, match="was not closed properly; run `rosbag reindex"):
        read_recording(cut)
    bag.close()


def test_command_line_writes_the_report_and_prints_it(full_bag, tmp_path, capsys):
    assert main([str(full_bag), "--output", str(tmp_path / "out")]) == 0
    printed = capsys.readouterr().out
    assert "lag_removed: " in printed and str(tmp_path / "out" / "figure8.png") in printed.replace("\n", "")
    assert json.loads((tmp_path / "out/summary.json").read_text())["samples"] > 700


def test_a_plan_that_is_not_what_its_hash_says_is_not_read(tmp_path):
    robot = kr120()
    plan = make_plan(time_path(np.array([robot.home, np.add(robot.home, 0.2)]), robot))
    message = plan_to_msg(plan, "base_link", np.zeros((len(plan.trajectory.times), 3)))
    message.hash = "0" * 64
    write_bag(tmp_path / "run.bag", "/kr120/plan", message)
    with pytest.raises(ConstructionTwinError, match=f"plan {plan.id} has hash"):
        read_plans(tmp_path / "run.bag")


def with_definition(kind, definition: str, md5: str | None = None) -> type:
    """Return a message class of the same name whose bag carries another definition."""
    return type(
        kind.__name__, (kind,), {"_full_text": definition, "_md5sum": md5 or kind._md5sum, "__slots__": kind.__slots__}
    )


#: In genpy's generated code, a constant's name stands outside of any quotes.
HOSTILE = "int32 A=1\nstring B=x\nfloat64[] position\n"


@pytest.fixture
def generated(monkeypatch, full_bag):
    """Definitions from which rosbags generated code, after this package's own."""
    seen = []
    read_recording(full_bag)
    monkeypatch.setattr(Typestore, "register", lambda store, definitions: seen.append(definitions))
    return seen


def test_a_bag_s_own_definitions_are_never_run(recording, tmp_path, generated):
    hostile = with_definition(JointState, HOSTILE)
    with rosbag.Bag(str(tmp_path / "x.bag"), "w") as bag:
        for topic in ("twin", "physical"):
            for step in range(3):
                message = hostile(header=Header(stamp=at(BASE + step)), name=["j"], position=[float(step)])
                bag.write(f"/a/{topic}/joint_states", message, at(BASE + step))
        bag.write("/a/other", with_definition(String, HOSTILE, "0" * 32)("x"), at(BASE))
    assert HOSTILE.encode() in (tmp_path / "x.bag").read_bytes()
    read = read_recording(tmp_path / "x.bag")
    assert read.twin.positions.ravel().tolist() == [0.0, 1.0, 2.0] and not generated


def test_another_definition_of_a_known_type_is_refused_in_one_sentence(tmp_path, generated):
    other = with_definition(JointState, "float64[] position\n", "1" * 32)
    with rosbag.Bag(str(tmp_path / "x.bag"), "w") as bag:
        for topic in ("twin", "physical"):
            bag.write(f"/a/{topic}/joint_states", other(), at(BASE))
    with pytest.raises(
        ConstructionTwinError,
        match=r"another definition of sensor_msgs/JointState \(md5 .*, installed",
    ):
        read_recording(tmp_path / "x.bag")
    assert not generated


@pytest.mark.parametrize("seed", range(40))
def test_a_damaged_bag_is_read_or_refused(tmp_path, seed):
    """A byte of it changed: what still can be read is read, and nothing but a typed error comes out."""
    file = tmp_path / "damaged.bag"
    with rosbag.Bag(str(file), "w") as bag:
        for number in range(20):
            for side in ("twin", "physical"):
                message = JointState(
                    header=Header(stamp=at(BASE + number * 4_000_000)), name=list(JOINTS), position=[0.0] * 6
                )
                bag.write(f"/kr120/{side}/joint_states", message, message.header.stamp)
    contents = bytearray(file.read_bytes())
    rng = np.random.default_rng(seed)
    # most of what is not a message stands at both ends
    place = rng.integers(len(contents)) if seed % 2 else -int(rng.integers(1, 900))
    contents[place] ^= int(rng.integers(1, 256))
    file.write_bytes(contents)
    with contextlib.suppress(ConstructionTwinError):
        read_recording(file)


def test_a_folder_that_takes_no_files_is_found_before_anything_is_computed(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(
        "construction_twin.ros.commands.evaluate.read_recording", lambda *_: pytest.fail("computed first")
    )
    (tmp_path / "file").write_text("in the way")
    for folder in (tmp_path / "file", tmp_path / "file" / "results", "/proc/results"):
        assert main([str(tmp_path / "no.bag"), "--output", str(folder)]) == 1
        said = capsys.readouterr().err
        assert (
            said.startswith(f"evaluate: {folder}: found ")
            and "expected a folder that files can be written into" in said
        )
