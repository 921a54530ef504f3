"""What a rotor model is made of: the contract of an effect, rotors, and conditions."""
