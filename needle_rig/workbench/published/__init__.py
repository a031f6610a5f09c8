"""The same questions asked of published settled values instead of traces."""
