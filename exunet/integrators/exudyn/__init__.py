"""The only package that imports Exudyn: the multibody model and its time stepping."""
