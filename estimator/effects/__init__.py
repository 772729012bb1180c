"""What a simulation of the leg can get wrong: one small class an effect."""
