"""A small SPEED+ set: three domains, and a camera with distortion."""

import json

from PIL import Image

# The published camera through ten, in pixels of ten times the pitch.
CAMERA = {
    "Nu": 192,
    "Nv": 120,
    "ppx": 5.86e-5,
    "ppy": 5.86e-5,
    "fx": 0.0175130,
    "fy": 0.0175116,
    "ccx": 96,
    "ccy": 60,
    "cameraMatrix": [[298.857, 0, 96], [0, 298.834, 60], [0, 0, 1]],
    "distCoeffs": [-0.22383, 0.51409, -0.00066, -0.00021, -0.13124],
}
LISTS = {
    "synthetic/train": "q_vbs2tango_true",
    "synthetic/validation": "q_vbs2tango",  # the older key
    "lightbox/test": "q_vbs2tango_true",
    "sunlamp/test": "q_vbs2tango_true",
}


def write_speedplus(root, count=1):
    """Write a set with so many images in each list, those of validation numbered on."""
    for place, (file, key) in enumerate(LISTS.items()):
        path = root / f"{file}.json"
        (path.parent / "images").mkdir(parents=True, exist_ok=True)
        first = count + 1 if "validation" in file else 1
        rows = []
        for index in range(count):
            name = f"img{first + index:06}.jpg"
            label = {"r_Vo2To_vbs_true": [1.0, -0.5, 4 + place + index], key: [0.6, 0, -0.8, 0]}
            rows.append({"filename": name, **label})
            Image.new("L", (192, 120), 40).save(path.parent / "images" / name)
        path.write_text(json.dumps(rows))
    (root / "camera.json").write_text(json.dumps(CAMERA))
    return root
