"""The model held against measurements: where it fails, which effect is missing, what adding it buys."""
