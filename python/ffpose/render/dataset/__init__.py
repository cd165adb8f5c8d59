"""Sets of images on disk: their files, their labels, and the processes that write them."""
