"""The texture paper: gratings under a sliding finger, refractory periods, recurrent spiking networks."""
