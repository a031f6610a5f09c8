"""The page: the rig alive and the workbench by clicks, served on loopback by a process of its own."""
