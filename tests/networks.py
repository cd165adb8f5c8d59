"""Small networks of each kind, for tests that any network must pass."""

SIZE = (64, 64)

NETWORKS = {
    "transformerpose": {
        "backbone": "compact_resnet_narrow",
        "depth": 1,
        "dim": 16,
        "heads": 2,
        "feed_forward": 16,
        "head_hidden": 16,
        "dropout": 0.0,
    },
    "ursonet": {
        "backbone": "compact_resnet_narrow",
        "reduction": 16,
        "hidden": 64,
        "bins_per_dim": 10,
        "smoothing": 3.0,
    },
    "posenet": {"backbone": "compact_resnet_narrow", "reduction": 16},
}
"""Fields of the presets that make them small."""

MODEL_FIELDS = {name: {"image_size": list(SIZE), **f} for name, f in NETWORKS.items()}
