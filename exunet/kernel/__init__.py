"""Forces of a whole net in compiled code, specialised to the terms that a scene has."""
