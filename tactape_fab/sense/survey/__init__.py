"""Survey: where the parts of a tape stand, from use: one adjustment over many contacts. It needs SciPy."""
