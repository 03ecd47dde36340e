"""Forces on a rotor from what is around it: supports, stops, seals, stators, the ground."""
