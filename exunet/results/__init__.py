"""What a run leaves: files, measures, comparison, summary."""
