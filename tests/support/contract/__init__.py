"""The contract as tests use it: operations by address, bodies against their schemas, examples from a real run."""
