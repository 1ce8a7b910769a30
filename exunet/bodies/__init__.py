"""Rigid bodies: their keys in a case."""
