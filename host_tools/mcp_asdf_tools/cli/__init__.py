"""The subcommands of ``mcp-asdf``, one module each (see ``mcp_asdf_tools.cli.main.Command``)."""
