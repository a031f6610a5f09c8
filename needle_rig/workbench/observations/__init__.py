"""What was measured, as independent numbers with their noise."""
