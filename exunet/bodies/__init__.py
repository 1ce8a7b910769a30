"""Rigid bodies: mass, inertia, attitude."""
