"""`gridpose measurements`: what came of images, and corrections of what was said about them."""
