"""CasADi functions of distances: capsules, boxes, clearances, and rows of the quadratic program."""
