from construction_twin.core.units import CYCLE_NS
from construction_twin.twin.virtual_robot import GazeboTwin


def commanded(count: int, first: int = 1) -> GazeboTwin:
    twin = GazeboTwin()
    for number in range(first, first + count):
        assert twin.cycle((0.0,)) is None
        twin.on_published(number * CYCLE_NS)
    return twin


def test_each_command_is_answered_once_and_in_order():
    twin = commanded(5)
    assert twin.on_simulated_pose(2 * CYCLE_NS)
    # the first one was skipped, the second one is answered
    assert not twin.on_simulated_pose(CYCLE_NS) and not twin.on_simulated_pose(2 * CYCLE_NS)
    assert twin.on_simulated_pose(5 * CYCLE_NS) and not twin.on_simulated_pose(3 * CYCLE_NS)


def test_a_stamp_of_no_command_is_no_answer_and_costs_none():
    twin = commanded(3)
    assert not twin.on_simulated_pose(7) and not twin.on_simulated_pose(4 * CYCLE_NS)
    assert twin.on_simulated_pose(CYCLE_NS)


def test_it_says_when_it_is_late_and_when_it_is_silent():
    assert commanded(25).fault == ""
    assert commanded(26).fault == "Gazebo is 104 ms behind what is commanded"
    twin = commanded(400)
    assert twin.fault.startswith("Gazebo has answered no command for 1 s")
    assert twin.on_simulated_pose(400 * CYCLE_NS) and twin.fault == ""
