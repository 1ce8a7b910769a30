"""Who steps in time: Exudyn, or the compiled loop, behind one protocol."""
