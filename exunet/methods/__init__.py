"""The integration methods: their names and all facts about them."""
