"""What surrounds a service in tests: processes, proxies, PostgreSQL, S3, systemd."""
