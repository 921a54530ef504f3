"""How a rotor answers: closed form, harmonic balance, stability, integration in time."""
