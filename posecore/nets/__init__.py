"""Networks: layers and blocks that two papers share, or that are a subject of their own."""
