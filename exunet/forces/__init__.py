"""Every force law, once."""
