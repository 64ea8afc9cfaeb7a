"""Nodes that drive or command a device: managed by the life cycle of ROS 2, and safe in every state but `active`.

`configure`, `activate`, `deactivate`, `cleanup` and `shutdown` come through the usual services (`~/change_state` and its
companions). The parameter `autostart` does the first two at the start, so that `ros2 run` alone works.
"""

from __future__ import annotations

import traceback
from abc import abstractmethod
from collections.abc import Callable
from typing import Any

from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from vo2_models.parameters import Parameter

from vo2_interface.diagnostics import Diagnostics
from vo2_interface.samples import MalformedSampleError

__all__ = ["AUTOSTART", "ManagedNode"]

AUTOSTART = Parameter(
    "autostart", True, "", "Configure and activate at the start; off, wait for lifecycle transitions."
)
_CONCERN = "lifecycle"
_DONE = {
    "configure": "configured",
    "activate": "active",
    "deactivate": "deactivated: safe current",
    "cleanup": "unconfigured",
    "shutdown": "shut down: safe current",
}


class ManagedNode(LifecycleNode):
    """A node whose device is at the safe current in every state but `active`.

    A node built on it calls `_manage` at the end of its constructor and implements `_configure`, `_activate`, `_rest` and
    `_cleanup`. What it hears it takes through `_guarded`: a fault in its own code then leads over `_rest` to
    `unconfigured` and not to a dead process with the heater on.

    Parameters
    ----------
    name : of the node
    namespace : its default namespace
    """

    def __init__(self, name: str, *, namespace: str) -> None:
        super().__init__(name, namespace=namespace)
        # rclpy's own handler dies of a transition that the state does not have, and the process with it
        self._service_change_state.callback = self._on_change_state
        self._active = self._broken = self._starting = False
        self._cause: Exception | None = None
        self._outlet: Diagnostics | None = None

    @abstractmethod
    def _configure(self) -> None:
        """Build from the present parameters; a `ValueError` says why that cannot be done."""

    def _activate(self) -> None:
        """Begin as for a device that has been switched on; a `ValueError` says why that cannot be done."""

    @abstractmethod
    def _rest(self) -> None:
        """Leave the device at the safe current. May be called in any state and any number of times."""

    def _cleanup(self) -> None:
        """Let go what `_configure` made."""

    @property
    def active(self) -> bool:
        """Whether the node may drive or command."""
        return self._active

    @property
    def lifecycle_state(self) -> str:
        """Name of the present state: unconfigured, inactive, active or finalized."""
        return str(self._state_machine.current_state[1])

    def close(self) -> None:
        """Leave the device at the safe current: the process ends."""
        self._active = False
        self._rest()

    def _manage(self, diagnostics: Diagnostics, *, autostart: bool) -> None:
        """Begin the managed life.

        Raises
        ------
        ValueError : with `autostart`, why the node cannot be configured or activated.
        """
        self._outlet = diagnostics
        if not autostart:
            self._say("ok", "unconfigured: waits for the transitions configure and activate")
            return
        self._starting = True
        for trigger in (self.trigger_configure, self.trigger_activate):
            if trigger() != TransitionCallbackReturn.SUCCESS:
                raise self._cause or RuntimeError(f"{self.get_name()} did not start")
        self._starting = False

    def _guarded(self, callback: Callable[..., None]) -> Callable[..., None]:
        """Return a callback that leads to the safe current where `callback` fails."""

        def call(*arguments: Any) -> None:
            try:
                callback(*arguments)
            except MalformedSampleError:
                raise
            except Exception as error:
                traceback.print_exc()
                self._fail(f"broke down ({error!r}, the log has the traceback)")

        return call

    def _fail(self, why: str) -> None:
        """Go to the safe current and to `unconfigured`, whatever the node is at."""
        self._broken = True
        self._say("error", f"{why}: safe current asked for; configure and activate it again")
        if self.lifecycle_state == "active":
            self.trigger_deactivate()
        elif self.lifecycle_state == "inactive":
            self.trigger_cleanup()
        self._broken = False

    # --- what the state machine calls ---------------------------------------------------------------

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Build; see `_configure`."""
        return self._attempt("configure", self._configure)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Begin to drive or command; see `_activate`."""
        result = self._attempt("activate", self._activate)
        self._active = result == TransitionCallbackReturn.SUCCESS
        return result

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Leave the device safe; see `_rest`."""
        self._active = False
        return self._attempt("deactivate", self._rest)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Let go what was built; see `_cleanup`."""
        return self._attempt("cleanup", self._cleanup)

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Leave the device safe, for good."""
        self._active = False
        return self._attempt("shutdown", self._end)

    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Leave the device safe and start over from `unconfigured`; `finalized` where even that fails."""
        self._active = False
        try:
            self._end()
        except Exception:
            traceback.print_exc()
            return TransitionCallbackReturn.FAILURE
        return TransitionCallbackReturn.SUCCESS

    def _end(self) -> None:
        self._rest()
        self._cleanup()

    def _attempt(self, name: str, step: Callable[[], None]) -> TransitionCallbackReturn:
        if self._broken:
            return TransitionCallbackReturn.ERROR
        try:
            step()
        except ValueError as error:
            self._cause = error
            if not self._starting:  # whoever starts the process tells it
                self._say("error", f"{name}: {' '.join(str(error).split())}")
            return TransitionCallbackReturn.FAILURE
        except Exception as error:
            self._cause = error
            traceback.print_exc()
            self._say("error", f"{name}: broke down ({error!r}): safe current")
            return TransitionCallbackReturn.ERROR
        self._say("ok", _DONE[name])
        return TransitionCallbackReturn.SUCCESS

    def _on_change_state(
        self, request: ChangeState.Request, response: ChangeState.Response
    ) -> ChangeState.Response:
        wanted: Transition = request.transition
        possible = {label: number for number, label, *_ in self._state_machine.available_transitions}
        name = wanted.label or next((one for one, number in possible.items() if number == wanted.id), "")
        triggers = {
            "configure": self.trigger_configure,
            "activate": self.trigger_activate,
            "deactivate": self.trigger_deactivate,
            "cleanup": self.trigger_cleanup,
            "shutdown": self.trigger_shutdown,
        }
        if name not in possible or name not in triggers:
            able = ", ".join(one for one in triggers if one in possible) or "nothing"
            self._say(
                "warn", f"found transition {name or wanted.id}; {self.lifecycle_state}, need one of {able}"
            )
            return response
        response.success = triggers[name]() == TransitionCallbackReturn.SUCCESS
        return response

    def _say(self, level: str, text: str) -> None:
        if self._outlet is not None:
            self._outlet.report(_CONCERN, level, text)
