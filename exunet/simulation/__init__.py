"""A run: plan, step control, guards, record, snapshots."""
