"""What a server decides, without any I/O: runs, requests for skills, robots that come and go, leases."""
