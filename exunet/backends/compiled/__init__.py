"""The compiled time loop: systems integrated without the engine, by the kernel of the fused form."""
