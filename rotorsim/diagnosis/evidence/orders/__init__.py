"""Recordings as order vectors over the speed, compared with order-tracked simulations of run-ups and coast-downs."""
