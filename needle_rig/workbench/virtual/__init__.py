"""A protocol run by a simulated needle, without drive and ticks: settled motions, states, datasets."""
