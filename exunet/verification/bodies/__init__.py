"""Rung 8: rigid bodies in both codes: masses, forces and torques, steps, trajectories, balances."""
