"""Sensors fitted to the types of their messages."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, assert_never

from pnm.errors import InputError
from pnm.knowledge.sensor_model import ExclusiveFact, Fact, Number, Object, Sensor, Statement, Stored
from pnm.ros.node.typed_fields import ANY, NUMBER, TEXT, fitted_source, fitted_test


def fitted(sensor: Sensor, message_type: Any) -> Sensor:
    """Return a sensor with the values of the type's constants in the place of their names."""
    return replace(sensor, statements=tuple([_fitted(statement, message_type) for statement in sensor.statements]))


def _fitted(statement: Statement, message_type: Any) -> Statement:
    try:
        match statement:
            case Fact(_, test):
                return replace(statement, test=fitted_test(test, message_type))
            case Number(_, source):
                return replace(statement, source=fitted_source(source, message_type, NUMBER, "a number"))
            case ExclusiveFact(_, source) | Object(_, source):
                return replace(statement, source=fitted_source(source, message_type, TEXT, "a text"))
            case Stored(_, source):
                return replace(statement, source=fitted_source(source, message_type, ANY, "a value"))
            case _:
                assert_never(statement)
    except InputError as error:
        raise InputError(error.message, statement.position) from error
