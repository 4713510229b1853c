"""tiswarm: large swarms of modular robots that find out where they are by touch."""

__version__ = "0.1.0"
