"""Timers of many nodes in one process."""

from collections import Counter

from rclpy.node import Node
from vo2_interface.testing import bench
from vo2_interface.timers import create_steady_timer, sharing_timers

NODES, PERIOD_S = 40, 0.1


def test_nodes_that_share_their_timers_are_all_called_at_every_period():
    calls = Counter()

    def make(number):
        node = Node("node", namespace=f"/n{number}")
        timers.append(create_steady_timer(node, PERIOD_S, lambda: calls.update([number])))
        timers.append(create_steady_timer(node, 60.0, lambda: None))
        return node

    timers = []
    with bench() as rig:
        with sharing_timers():
            for number in range(NODES):
                rig.add(lambda number=number: make(number))
        rig.spin(15 * PERIOD_S)
        assert len(set(map(id, timers))) == 2
        assert len(calls) == NODES and max(calls.values()) - min(calls.values()) <= 1
        assert create_steady_timer(rig.node, PERIOD_S, lambda: None) not in timers
