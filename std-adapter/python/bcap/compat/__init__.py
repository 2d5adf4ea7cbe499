"""The maker's Python client with another import: `from bcap.compat import bcapclient`."""
