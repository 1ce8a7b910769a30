"""The compiled time loop: systems integrated without the engine."""
