"""The compiled time loop: a net alone, integrated without the engine by the same kernel."""
