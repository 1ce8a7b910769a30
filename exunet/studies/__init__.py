"""Many runs: cost, effects, ensembles, errors."""
