"""The UR5 at joint level: protocols of its controller, pure; nothing here moves an arm yet."""
