"""The engine beside hand-written C and beside other programs: speed, controllers, peers."""
