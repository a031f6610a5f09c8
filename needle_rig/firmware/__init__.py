"""The nodes' firmware: building it, running it on a PC and under an emulator. Needs the `dev` extra."""
