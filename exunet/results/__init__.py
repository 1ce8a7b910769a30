"""Results of a run: files, measures, comparison, summary."""
