"""The ladder of verification: Exudyn's net against reference_impl, and both against known answers."""
