"""Made worlds on disk: made once, in parallel, and found again by what they were made from."""

from data_tools.storage.cache import cache_size, clean
from data_tools.storage.making import MakingError
from data_tools.storage.shards import DamagedShard
from data_tools.storage.store import DamageWarning, Store
from data_tools.storage.versions import code_version

__all__ = [
    "DamageWarning",
    "DamagedShard",
    "MakingError",
    "Store",
    "cache_size",
    "clean",
    "code_version",
]
