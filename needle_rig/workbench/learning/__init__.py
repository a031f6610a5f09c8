"""Compare, diagnose, adopt: the error falls step by step."""
