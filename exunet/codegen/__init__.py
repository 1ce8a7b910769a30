"""Force laws to compiled functions, specialised to the terms that a scene has."""
