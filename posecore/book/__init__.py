"""What only chapters use: checks of exercises, the ledger of claims, source on the page."""
