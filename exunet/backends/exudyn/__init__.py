"""The only room that knows Exudyn: the multibody model and its time stepping."""
