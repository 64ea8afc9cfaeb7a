"""Parameters from records: declared with range and text, checked, changed at run time."""

import pytest
from rcl_interfaces.msg import ParameterType
from rcl_interfaces.srv import GetParameters, ListParameters
from rclpy.node import Node
from rclpy.parameter import Parameter as RosParameter
from vo2_interface.model import model_parameters
from vo2_interface.parameters import ParameterTable, ros_parameters
from vo2_interface.testing import bench
from vo2_models.parameters import Parameter

RECORDS = (
    Parameter("gain", 2.0, "A/m", "A gain.", 0.0, 10.0),
    Parameter("count", 3, "1", "A count.", 1, 5),
    Parameter("kind", "pi", "", "A kind.", choices=("pi", "pid")),
    Parameter("levels", [], "m", "Levels.", -1.0, 1.0, kind="float_array"),
    Parameter("on", True, "", "A switch."),
)


def table_of(arguments=(), **options):
    with bench(["--ros-args", *arguments] if arguments else []):
        node = Node("node")
        try:
            yield node, ParameterTable(node, RECORDS, **options)
        finally:
            node.destroy_node()


def test_descriptor_carries_range_unit_and_text():
    for node, _ in table_of():
        descriptor = node.describe_parameter("gain")
        assert descriptor.description == "A gain. [A/m]"
        assert (
            descriptor.floating_point_range[0].from_value,
            descriptor.floating_point_range[0].to_value,
        ) == (0, 10)
        assert node.describe_parameter("count").integer_range[0].to_value == 5
        assert "pi, pid" in node.describe_parameter("kind").additional_constraints


def test_values_from_the_command_line_are_given_and_defaults_are_not():
    for _, table in table_of(["-p", "gain:=3.5", "-p", "levels:=[0.5, 0.25]"]):
        assert table.number("gain") == 3.5
        assert table.numbers("levels") == [0.5, 0.25]
        assert table.given() == {"gain": 3.5, "levels": [0.5, 0.25]}


@pytest.mark.parametrize(
    ("argument", "needs"),
    [
        ("gain:=11.0", "gain: need a number with a decimal point, 0 to 10 A/m"),
        ("gain:=1", "gain: need a number with a decimal point"),
        ("count:=9", "count: need a whole number, 1 to 5 ("),
        ("kind:=bang", "kind: need one of pi, pid"),
        ("levels:=[0.5, 7.0]", "levels: need an array"),
    ],
)
def test_a_bad_value_is_refused_with_what_is_needed(argument, needs):
    with pytest.raises(ValueError, match="need") as caught:
        next(table_of(["-p", argument]))
    assert needs in str(caught.value)


def test_a_change_counts_and_a_refused_one_does_not():
    for node, table in table_of(read_only=("count",)):
        before = table.revision
        assert node.set_parameters([RosParameter("gain", value=4.0)])[0].successful
        assert (table.number("gain"), table.revision) == (4.0, before + 1)
        refused = node.set_parameters([RosParameter("kind", value="bang")])[0]
        assert not refused.successful
        assert "need one of pi, pid" in refused.reason
        assert not node.set_parameters([RosParameter("count", value=4)])[0].successful
        assert not node.set_parameters([RosParameter("levels", value=[0.1, float("nan")])])[0].successful
        assert table.revision == before + 1


def test_every_model_parameter_can_be_declared_set_and_read_back():
    records = model_parameters()
    assert len({record.name for record in records}) == len(records) > 50
    with bench():
        node = Node("node")
        table = ParameterTable(node, records)
        values = {
            record.name: [0.0 if record.lower is None else record.lower]
            for record in records
            if record.type == "float_array"
        }
        for parameter in ros_parameters(values):
            assert node.set_parameters([parameter])[0].successful, parameter.name
        assert table.given("model.") == values
        node.destroy_node()


def test_all_parameters_are_got_at_once_as_ros2_param_dump_asks():
    with bench() as rig:
        node = rig.add(lambda: Node("node"))
        table = ParameterTable(node, (*RECORDS, *model_parameters()))
        listing = rig.node.create_client(ListParameters, "/node/list_parameters")
        getting = rig.node.create_client(GetParameters, "/node/get_parameters")
        rig.until(lambda: listing.service_is_ready() and getting.service_is_ready())
        answer = listing.call_async(ListParameters.Request())
        rig.until(answer.done)
        names = answer.result().result.names
        assert {record.name for record in model_parameters()} < set(names)
        answer = getting.call_async(GetParameters.Request(names=names))
        rig.until(answer.done)
        values = dict(zip(names, answer.result().values, strict=True))
        assert all(value.type != ParameterType.PARAMETER_NOT_SET for value in values.values())
        assert values["levels"].type == ParameterType.PARAMETER_DOUBLE_ARRAY
        assert table.given() == {}
        assert table.revision == 0


def test_what_was_dumped_can_be_given_at_the_start(tmp_path):
    path = tmp_path / "dumped.yaml"
    path.write_text("node:\n  ros__parameters:\n    gain: 3.5\n    levels: []\n")
    for _, table in table_of(["--params-file", str(path)]):
        assert table.number("gain") == 3.5
        assert table.numbers("levels") == []
