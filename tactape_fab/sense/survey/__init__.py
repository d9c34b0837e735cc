"""Survey: where the parts of a tape are, from use: one adjustment over many contacts. It needs SciPy."""
