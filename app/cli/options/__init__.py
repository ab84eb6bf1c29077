"""Options that several commands share: access to a service, and the data folder."""
