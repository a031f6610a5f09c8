"""What `hazards` is made of: rigs in virtual time, faults, trials of them, and tables."""
