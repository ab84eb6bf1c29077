"""Drawn and rendered boards, and how far what is found of them is from the truth."""
