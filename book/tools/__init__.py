"""How the book is made: what `make.py` runs."""
