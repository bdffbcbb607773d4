"""Vector fields: PVNet, the projection loss, and a refinement that knows when it is needed."""
