"""Forward selection: every fault candidate at every place, fitted, judged, and the best one kept."""
