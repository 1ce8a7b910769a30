"""What every other package uses: errors, validated tables, whole files, interrupts."""
