"""What a capture costs for what is to be known of it: settings judged by what became of the target."""
