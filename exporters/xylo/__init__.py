"""XyloAudio 2: a network in the chip's integers, its arithmetic, and the proof against the chip's own simulator."""
