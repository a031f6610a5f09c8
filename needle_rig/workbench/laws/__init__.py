"""Laws that no library holds: where, on which variable, which curve, which formula."""
