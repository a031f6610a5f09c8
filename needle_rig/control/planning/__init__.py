"""What the planner believes of the needle, and how it looks for rotations."""
