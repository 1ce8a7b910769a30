"""The simulated system: blocks and layout, energy and momentum balances, stable step."""
