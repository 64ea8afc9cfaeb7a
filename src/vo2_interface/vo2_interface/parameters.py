"""ROS parameters from `Parameter` records: declared with type, unit, range and description, checked when set."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Mapping

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor, SetParametersResult
from rclpy.exceptions import ParameterException
from rclpy.node import Node
from rclpy.parameter import Parameter as RosParameter
from vo2_models.parameters import Parameter, Value

__all__ = ["ParameterTable", "ros_parameters"]

_ROS_TYPE = {
    "float": RosParameter.Type.DOUBLE,
    "int": RosParameter.Type.INTEGER,
    "bool": RosParameter.Type.BOOL,
    "string": RosParameter.Type.STRING,
    "float_array": RosParameter.Type.DOUBLE_ARRAY,
    "string_array": RosParameter.Type.STRING_ARRAY,
}
_LARGEST = sys.float_info.max
_LARGEST_INT = 2**63 - 1


class ParameterTable:
    """The parameters of a node, kept as plain values.

    Parameters
    ----------
    node : the node that declares them
    records : what to declare
    read_only : names that are fixed once the node runs
    judge : is given the values that a change would lead to, those set only, and raises `ValueError` to refuse it;
        not asked for what the node starts with, from which it builds itself

    Attributes
    ----------
    revision : grows by one with every accepted change, so that a node rebuilds what depends on
        parameters at its next sample and not in the middle of a change

    Raises
    ------
    ValueError : a value given on the command line or in a file has the wrong type or is out of range;
        the message names the parameter, what was found and what is needed.
    """

    def __init__(
        self,
        node: Node,
        records: Iterable[Parameter],
        *,
        read_only: Iterable[str] = (),
        judge: Callable[[Mapping[str, Value]], None] | None = None,
    ) -> None:
        self._node = node
        self._records = {record.name: record for record in records}
        self._values: dict[str, Value] = {name: record.default for name, record in self._records.items()}
        self._given: set[str] = set()
        self._judge: Callable[[Mapping[str, Value]], None] | None = None
        self.revision = 0
        fixed = set(read_only)
        node.add_on_set_parameters_callback(self._check)
        for record in self._records.values():
            self._declare(record, read_only=record.name in fixed)
        self._set_empty_arrays()
        node.add_post_set_parameters_callback(self._accept)
        self._judge = judge

    def __getitem__(self, name: str) -> Value:
        return self._values[name]

    def number(self, name: str) -> float:
        """Return a float or int parameter as a float."""
        value = self._values[name]
        if isinstance(value, str | list):
            raise TypeError(f"{name} is not a number")
        return float(value)

    def text(self, name: str) -> str:
        """Return a string parameter."""
        return str(self._values[name])

    def flag(self, name: str) -> bool:
        """Return a bool parameter."""
        return bool(self._values[name])

    def numbers(self, name: str) -> list[float]:
        """Return a float array parameter."""
        value = self._values[name]
        if not isinstance(value, list):
            raise TypeError(f"{name} is not an array")
        return [float(element) for element in value]

    def given(self, prefix: str = "") -> dict[str, Value]:
        """Return the parameters below `prefix` that a file, the command line or a service has set."""
        return {
            name: self._values[name]
            for name in self._records
            if name in self._given and name.startswith(prefix)
        }

    def undeclared(self, prefix: str) -> dict[str, Value]:
        """Return what a file or the command line gives below `prefix` and the node does not declare; ROS says nothing of it."""
        overrides = self._node._parameter_overrides  # rclpy has no other way to them
        return {
            name: _from_ros(parameter)
            for name, parameter in overrides.items()
            if name.startswith(prefix) and name not in self._records
        }

    def set(self, values: Mapping[str, Value]) -> None:
        """Set declared parameters from inside the node, as a service call would; refuse all or none."""
        result = self._node.set_parameters_atomically(
            [
                RosParameter(name, _ROS_TYPE[self._records[name].type], _plain(self._records[name], value))
                for name, value in values.items()
            ]
        )
        if not result.successful:
            raise ValueError(result.reason)

    def _declare(self, record: Parameter, *, read_only: bool) -> None:
        descriptor = _describe(record)
        descriptor.read_only = read_only
        ros_type = _ROS_TYPE[record.type]
        # ROS cannot tell the type of an empty array that is declared: it is set afterwards, with its type
        empty = isinstance(record.default, list) and not record.default
        try:
            declared = self._node.declare_parameter(
                record.name, ros_type if empty else _plain(record, record.default), descriptor
            )
        except ParameterException as error:
            raise ValueError(f"{record.name}: {_needs(record)} ({error.args[0]})") from error
        if declared.type_ != RosParameter.Type.NOT_SET:
            value = _from_ros(declared)
            if value != record.default:
                self._given.add(record.name)
            self._values[record.name] = value

    def _set_empty_arrays(self) -> None:
        """Give every array without elements its typed value: one that is unset makes `ros2 param dump` get nothing."""
        unset = [
            RosParameter(name, _ROS_TYPE[record.type], [])
            for name, record in self._records.items()
            if self._node.get_parameter_or(name).type_ == RosParameter.Type.NOT_SET
        ]
        if unset and not (result := self._node.set_parameters_atomically(unset)).successful:
            raise ValueError(result.reason)

    def _check(self, parameters: list[RosParameter]) -> SetParametersResult:
        # rclpy asks for the parameters of subscriptions too, which say nothing of ours
        judge = self._judge if any(each.name in self._records for each in parameters) else None
        after = self.given() if judge is not None else {}
        try:
            for parameter in parameters:
                record = self._records.get(parameter.name)
                if record is None or parameter.type_ == RosParameter.Type.NOT_SET:
                    continue
                record.check(_from_ros(parameter))
                after[parameter.name] = _from_ros(parameter)
            if judge is not None:
                judge(after)
        except ValueError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _accept(self, parameters: list[RosParameter]) -> None:
        for parameter in parameters:
            if parameter.name in self._records and parameter.type_ != RosParameter.Type.NOT_SET:
                self._values[parameter.name] = _from_ros(parameter)
                self._given.add(parameter.name)
        self.revision += 1


def ros_parameters(values: Mapping[str, Value]) -> list[RosParameter]:
    """Return flat values as ROS parameters, numbers in arrays as doubles; empty arrays are left out."""
    result = []
    for name, value in values.items():
        if isinstance(value, list | tuple):
            if not value:
                continue
            value = list(value) if isinstance(value[0], str) else [float(element) for element in value]
        result.append(RosParameter(name, value=value))
    return result


def _plain(record: Parameter, value: Value) -> object:
    if record.type == "float":
        return float(value)  # type: ignore[arg-type]
    if record.type == "float_array":
        return [float(element) for element in value]  # type: ignore[union-attr]
    return value


def _from_ros(parameter: RosParameter) -> Value:
    value = parameter.value
    return value if isinstance(value, bool | int | float | str) else list(value)


def _describe(record: Parameter) -> ParameterDescriptor:
    unit = f" [{record.unit}]" if record.unit else ""
    descriptor = ParameterDescriptor(name=record.name, description=f"{record.description}{unit}")
    if record.choices:
        descriptor.additional_constraints = f"one of {', '.join(record.choices)}"
    if record.lower is None and record.upper is None:
        return descriptor
    if record.type == "float":
        low = -_LARGEST if record.lower is None else float(record.lower)
        high = _LARGEST if record.upper is None else float(record.upper)
        descriptor.floating_point_range = [FloatingPointRange(from_value=low, to_value=high, step=0.0)]
    elif record.type == "int":
        low_int = -_LARGEST_INT if record.lower is None else int(record.lower)
        high_int = _LARGEST_INT if record.upper is None else int(record.upper)
        descriptor.integer_range = [IntegerRange(from_value=low_int, to_value=high_int, step=1)]
    elif record.type == "float_array":
        descriptor.additional_constraints = _needs(record)
    return descriptor


def _needs(record: Parameter) -> str:
    kind = {
        "float": "a number with a decimal point",
        "int": "a whole number",
        "bool": "true or false",
        "string": "a text",
        "float_array": "an array of numbers with decimal points",
        "string_array": "an array of texts",
    }[record.type]
    if record.choices:
        return f"need one of {', '.join(record.choices)}"
    if record.lower is None and record.upper is None:
        return f"need {kind}"
    low, high = (
        text if end is None else str(int(end)) if record.type == "int" else f"{end:g}"
        for end, text in ((record.lower, "-inf"), (record.upper, "inf"))
    )
    unit = "" if record.unit == "1" else record.unit
    return f"need {kind}, {low} to {high} {unit}".rstrip()
