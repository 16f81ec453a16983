function waitForServer(client)
  printf('waits for %s\n', client.ActionName);
end
