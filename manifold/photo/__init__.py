"""A material from photographs of a ball under known light."""
