"""What accuracy costs: settings of a scene with their wall times, errors and measures."""
