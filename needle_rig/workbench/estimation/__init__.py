"""One model fitted to the observations: posterior, its maximum, discretisation error, cross-validation."""
