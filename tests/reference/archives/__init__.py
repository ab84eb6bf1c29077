"""Session archives as earlier versions wrote them."""
