"""What is simulated, as one system: blocks and layout, energy and momentum balances, stable step."""
