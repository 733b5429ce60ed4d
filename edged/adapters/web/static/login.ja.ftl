# Texts of the forms that come before anything else. The cell writes these pages: each text on one line.

## Log in
login-title = { $cell }：ログイン
login-name = 名前
login-name-or-page = 名前（ステータスページのパスワードを使う場合は空欄）
login-password = パスワード
login-password-of-page = { $cell } のステータスページのパスワード
login-button = ログイン
login-code = コードを持っています
login-wrong = 名前またはパスワードが違います。
login-wrong-password = パスワードが違います。
login-wait = { $wait_s } 秒間はパスワードを受け付けません。誤りが多すぎたか、別のパスワードを確認中です。その後もう一度お試しください。

## Come in by a code
invite-title = { $cell }：コード
invite-what = コードはセルのログにあるか、{ $command } で発行されます。1 回だけ有効で、使うとエンジニアになります。
invite-code = コード
invite-name = あなたの名前
invite-password = パスワード（{ $least } 文字以上）
invite-again = パスワードをもう一度
invite-wrong = コードが誤っているか、使用済み、別の名前のもの、または 1 日以上前のものです。{ $command } で新しく発行できます。
invite-differ = 2 つのパスワードが一致しません。
invite-short = 名前と、{ $least } 文字以上のパスワードを入力してください。
invite-common = このパスワードは推測されやすすぎます。自分の名前を含まない、複数の単語からなるものにしてください。
invite-storage = エンジニアにできません：{ $detail }
