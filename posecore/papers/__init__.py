"""The papers: one subpackage or file per system."""
