"""What every room stands on: errors, validated tables, whole files, interrupts."""
