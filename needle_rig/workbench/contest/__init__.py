"""Strategies against each other on the simulated rig."""
