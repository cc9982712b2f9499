"""Spiking touch: taxel signals to mechanoreceptor spikes to a decision, and what each saving costs."""

__version__ = "0.1.0"
