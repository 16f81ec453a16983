"""The steps of `twin work` and their options. Angles in deg, lengths in mm."""

from __future__ import annotations

import argparse

from construction_twin.views.arguments import add_approve, finite


def add_steps(work: argparse.ArgumentParser, common: argparse.ArgumentParser) -> None:
    """Add the steps of `twin work`, each with the options in `common`."""
    steps = work.add_subparsers(dest="step", required=True, metavar="STEP")

    def step(name: str, text: str) -> argparse.ArgumentParser:
        return steps.add_parser(name, help=text, description=f"{text[0].upper()}{text[1:]}.", parents=[common])

    step("list", "list the tasks in their order, with states and deviations")
    _add_task(step("next", "have the next task planned for review, or the one that is named; nothing moves"), "?")
    _add_task(step("show", "show all that is known of a task"))
    add_approve(step("approve", "approve the plan of the task that is under review: it starts"))
    for name, text in (
        ("skip", "take a task out: what comes after it no longer waits for it"),
        ("redo", "have a task done again: its element is back in its stock"),
        ("removed", "say that what people were to take down, or what was placed, is gone: no obstacle any more"),
    ):
        told = step(name, text)
        _add_task(told)
        _add_person(told)
    answer = step("answer", "answer what a task asks: where its element is")
    _add_task(answer)
    answer.add_argument(
        "answer",
        metavar="ANSWER",
        help="in_stock, in_grip, placed, gone, done, not_done, stands or taken_away: one of those that `show` lists",
    )
    _add_person(answer)
    _add_person(step("accept", "accept the schedule that was proposed from the geometry"))
    measured = step("measured", "report where a placed element really is")
    measured.add_argument("element", metavar="ELEMENT", help="GlobalId of the element")
    measured.add_argument(
        "--pose",
        type=finite,
        nargs=6,
        required=True,
        metavar=("X", "Y", "Z", "A", "B", "C"),
        help="pose of the element's frame: position [mm] and KUKA's angles [deg]",
    )
    measured.add_argument(
        "--frame", default="", metavar="FRAME", help="link of the robot or tf frame of the pose [its base]"
    )
    _add_person(measured)


def _add_task(step: argparse.ArgumentParser, number: str | None = None) -> None:
    step.add_argument(
        "task", nargs=number, default="", metavar="ID", help="id or name of the task, or the beginning of one of them"
    )


def _add_person(step: argparse.ArgumentParser) -> None:
    step.add_argument("--person", default="", metavar="NAME", help="who says so [the user's name]")
    step.add_argument("--reason", default="", metavar="TEXT", help="kept with the record")
