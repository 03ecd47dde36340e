"""What drives a rotor: clock, references, unbalance, crack, recorded signals."""
