"""Order vectors over the speed of run-ups and coast-downs, and the critical speeds that they show."""
