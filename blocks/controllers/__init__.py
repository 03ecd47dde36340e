"""Controllers of magnetic bearings, which can be swapped for one another."""
