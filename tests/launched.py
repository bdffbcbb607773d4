"""Several processes that train together, without torchrun, which takes seconds to begin."""

import socket


def two_launched() -> list[dict[str, str]]:
    """What torchrun says to each of two in the environment; test_torchrun.py has torchrun do it."""
    with socket.socket() as server:
        server.bind(("127.0.0.1", 0))  # a port that nobody has
        port = str(server.getsockname()[1])
    group = {"WORLD_SIZE": "2", "MASTER_ADDR": "127.0.0.1", "MASTER_PORT": port}
    return [{**group, "RANK": rank, "LOCAL_RANK": rank} for rank in "01"]
