"""Methods: a package for each paper, and the command line that is written once for all of them."""
