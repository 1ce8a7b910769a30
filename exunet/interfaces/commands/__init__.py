"""What the commands do beyond one call: folders, progress, printing."""
