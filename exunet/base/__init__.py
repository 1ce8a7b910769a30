"""Errors, validated tables, whole files and interrupts that all packages use."""
