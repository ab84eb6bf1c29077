"""`gridpose webhooks`: who is notified by HTTP of what happens."""
