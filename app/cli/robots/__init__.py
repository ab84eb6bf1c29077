"""Robot identification: `gridpose robots export` and `gridpose robots plan`."""
