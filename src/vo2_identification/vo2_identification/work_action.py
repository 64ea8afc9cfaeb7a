"""A piece of work of a node as a ROS action: one goal at a time, told as it goes on, cancelled on request.

A goal stays accepted until its end is known, and is executed then: rclpy runs a coroutine that waits again and again, which
would take a loop its time. Where `vo2_msgs` is not built (wheels without a C compiler) there is no action; the services stay.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rclpy.action import ActionServer, CancelResponse
from rclpy.action.server import ServerGoalHandle
from rclpy.node import Node

try:
    from vo2_msgs import action as actions
except ModuleNotFoundError:
    actions = None

__all__ = ["WorkAction"]


class WorkAction:
    """Action server of work that the node does by itself between callbacks.

    Parameters
    ----------
    node : the action is one of, below its name
    kind : type in `vo2_msgs.action`; its result has a `message`
    name : of the action
    start : begins the work; returns whether it has begun, and why not
    cancel : gives the work up, and tells `end` so
    """

    def __init__(
        self,
        node: Node,
        kind: str,
        name: str,
        *,
        start: Callable[[], tuple[bool, str]],
        cancel: Callable[[], object],
    ) -> None:
        self._start, self._cancel = start, cancel
        self._goal: ServerGoalHandle | None = None
        self._server: ActionServer | None = None
        if actions is None:
            return
        self._kind = getattr(actions, kind)
        self._server = ActionServer(
            node,
            self._kind,
            f"~/{name}",
            self._kind.Result,
            handle_accepted_callback=self._on_goal,
            cancel_callback=self._on_cancel,
        )

    def destroy(self) -> None:
        """Leave the graph; before the node does."""
        if self._server is not None:
            self._server.destroy()
            self._server = None

    def publish_feedback(self, **feedback: object) -> None:
        """Send feedback to the client of the goal that is at work, if there is one.

        Parameters
        ----------
        feedback : fields of the action's feedback
        """
        if self._goal is not None:
            self._goal.publish_feedback(self._kind.Feedback(**feedback))

    def end(self, success: bool, **result: object) -> None:
        """End the goal that is at work, if there is one: succeeded, aborted, or canceled where its client asked for that.

        Parameters
        ----------
        success : whether the work was done
        result : fields of the action's result
        """
        goal, self._goal = self._goal, None
        if goal is not None:
            self._end(goal, success, result)

    def _on_goal(self, goal: ServerGoalHandle) -> None:
        if self._goal is not None:
            words = "busy: another goal is at work; wait for its end or cancel it first"
            self._end(goal, False, {"message": words})
            return
        self._goal = goal
        begun, words = self._start()
        if not begun:
            self.end(False, message=words)

    def _on_cancel(self, goal: ServerGoalHandle) -> CancelResponse:
        if self._goal is None or goal.goal_id != self._goal.goal_id:
            return CancelResponse.REJECT
        self._cancel()
        return CancelResponse.ACCEPT

    def _end(self, goal: ServerGoalHandle, success: bool, result: dict[str, object]) -> None:
        def ended(handle: ServerGoalHandle) -> Any:
            if success:
                handle.succeed()
            elif handle.is_cancel_requested:
                handle.canceled()
            else:
                handle.abort()
            return self._kind.Result(**result)

        goal.execute(ended)
