"""When the gateway may be armed: by whom, with which configuration, in this run, and with the arm where the gateway holds it.

Pure; rad.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from construction_twin.core.follower import Follower
from construction_twin.gateway.rsi_session import ControllerSession, distance_off
from construction_twin.gateway.states import State
from construction_twin.mqtt.messages import Control, is_session

if TYPE_CHECKING:
    from construction_twin.gateway.gateway import Gateway

#: Start tolerances between the measured and the held pose: a command may be one of them away from either.
DISPLACED = 2.0


def refusal_of_value(value: object, gateway: Gateway) -> str:
    """Return in one sentence why the value of an `arm` does not mean the gateway's configuration and run; "" when it does."""
    named = value if isinstance(value, dict) else {"hash": value}
    if named.get("hash") != gateway.config.hash:
        return f"configuration hash {named.get('hash')!r} is not the gateway's {gateway.config.hash}"
    if set(named) != {"hash", "run"}:
        return "arm must name hash and run of the gateway's status, and nothing else"
    if named["run"] != gateway.run:
        return f"run {named['run']!r} is not the gateway's present one: it was started again, or a recording is being replayed"
    return ""


def refusal_of_arm(control: Control, gateway: Gateway, controller: ControllerSession, follower: Follower | None) -> str:
    """Return in one sentence why an `arm` must be refused; "" when nothing speaks against it."""
    another = refusal_of_value(control.value, gateway)
    if another:
        return another
    if not is_session(control.session):
        return f"session {control.session!r} cannot be armed; expected 1 to 64 letters, digits, - and _"
    if gateway.fault:
        return "stopped since the last reset; reset first"
    if gateway.state is not State.READY or follower is None:
        return f"gateway is {gateway.state.value}: {gateway.reason}"
    distance = controller.measured and distance_off(controller.measured, follower.position, gateway.config, DISPLACED)
    if distance:
        return (
            f"{distance} off the pose that the gateway holds: the controller moved the arm, or it is still moving; "
            "reset, and if that does not help start the controller's program again"
        )
    return ""
