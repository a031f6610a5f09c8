"""Reed (2008) beside ours: its parameters and its figures."""
