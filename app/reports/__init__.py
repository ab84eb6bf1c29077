"""Documents from what records and analyses hold: arrays and figures in, bytes out; nothing is estimated here."""
