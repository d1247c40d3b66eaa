"""Fixtures of the tests of the wire; their code is in `wire_setup`, whose name no other room has."""

from wire_setup import any_wire, problem

__all__ = ["any_wire", "problem"]
