"""Rigid bodies: what a case says of them, mass and inertia, attitude."""
