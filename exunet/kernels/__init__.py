"""Force laws to compiled functions."""
