"""The book: its pages, what belongs to each chapter, and the tools that make it."""
