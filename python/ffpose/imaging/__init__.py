"""Images: read, made a network's input, augmented, cut into views, drawn on."""
