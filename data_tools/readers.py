"""Where each kind of source is read that `data_tools.open` knows.

The part of a source before its colon names a module and a callable, imported when first opened. The
callable takes what follows the colon (None if nothing does), `split` and the options.
"""

__all__ = ["READERS"]

READERS = {
    "bop": "data_tools.bop.dataset:BopDataset",
    "linemod": "data_tools.linemod:LinemodDataset",
    "hmdpose": "data_tools.hmdpose:HmdposeDataset",
    "pictures": "data_tools.pictures:PictureFolder",
    "headset": "data_tools.worlds.headset:WORLD.open",
    "tabletop": "data_tools.worlds.tabletop:WORLD.open",
    "categories": "data_tools.worlds.categories:WORLD.open",
}
